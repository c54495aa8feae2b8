"""Virtual devices: a network camera and relay boards that show a scene."""
