"""Shots -> lines: the stream that commands, live cameras, the console and studies share."""
