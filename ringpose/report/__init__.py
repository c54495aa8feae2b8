"""Results -> one HTML page with pictures; nothing here touches files."""
