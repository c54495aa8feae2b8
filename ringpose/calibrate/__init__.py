"""Board frames -> camera and light planes."""
