"""Hardware in the loop: the controller FMU against the real QUBE-Servo 2 or a simulated one."""
