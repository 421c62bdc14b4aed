"""The ground that the map shows to what drives on it."""
