"""Hardware -> shots."""
