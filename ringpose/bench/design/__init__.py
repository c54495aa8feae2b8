"""A rig and its variants -> maps of the accuracy that they allow."""
