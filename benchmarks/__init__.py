"""Charts of speed against accuracy, and of stability where methods fail; slow, so not part of the tests."""
