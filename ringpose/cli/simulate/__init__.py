"""`ringpose simulate`."""
