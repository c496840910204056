"""robot-agent doctor: looks at what a robot needs to follow, part by part, and names the command that mends it."""
