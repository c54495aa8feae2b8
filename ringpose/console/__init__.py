"""The simulation platform in the browser (extra `console`)."""
