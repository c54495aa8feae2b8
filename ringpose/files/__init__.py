"""Reading, validation and writing of files; all input is validated here, once."""
