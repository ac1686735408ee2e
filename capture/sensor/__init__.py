"""What the sensor and the lens do to light before it becomes numbers: noise and vignetting."""
