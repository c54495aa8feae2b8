"""The browser: the simulation platform (extra `console`), and recorded shots, live or as one file."""
