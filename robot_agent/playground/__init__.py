"""A Thymio II whose Aseba programs run in asebaplayground, seen by the simulator's camera (extras `sim`, `thymio`)."""
