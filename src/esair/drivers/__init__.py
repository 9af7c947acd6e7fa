"""A file for each part: what its bytes mean, and the sensor or actuator on a bus."""
