"""From radiance to camera files: sensors, their noise, their files."""
