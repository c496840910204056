"""A robot, a room and something to follow, simulated with MuJoCo (the `sim` extra)."""
