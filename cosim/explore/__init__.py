"""A scenario to play with: a local page with sliders, on which the laws answer side by side."""
