"""What samples show if cameras or the body are elsewhere than was thought."""
