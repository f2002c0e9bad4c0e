"""The controller of any linear model: one unit for up to 16 states, 8 inputs and 16 measured outputs."""
