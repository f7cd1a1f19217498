"""Questions about the paper and about methods; nothing outside imports from here."""
