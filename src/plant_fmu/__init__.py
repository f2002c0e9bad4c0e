"""The QUBE-Servo 2 rotary pendulum with its motor and encoders, eq. (5) of the paper."""
