"""Checks and updates of an existing rig."""
