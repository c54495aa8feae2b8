"""Pose records -> track: filtered pose and velocity of a moving ring (ringpose-method(7), sections 9 and 10)."""
