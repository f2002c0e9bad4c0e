"""The controller of the rotary pendulum: swing-up, capture, estimators and the stabilizing laws, as a unit."""
