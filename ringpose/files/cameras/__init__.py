"""Camera files of ringpose and of other programs."""
