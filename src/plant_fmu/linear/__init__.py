"""A linear plant of up to 16 states, 8 inputs and 16 outputs, exact under held inputs."""
