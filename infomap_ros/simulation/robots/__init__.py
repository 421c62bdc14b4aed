"""Other people's robots: what is read and guessed of them, and the file that holds it."""
