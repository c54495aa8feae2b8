"""Words -> calls: one module per subcommand, no arithmetic."""
