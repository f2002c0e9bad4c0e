"""The rotary pendulum, eq. (5) of the paper: one equation of motion for plant, controller, identification and tests."""
