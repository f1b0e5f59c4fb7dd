"""Records and draws episodes, with their explanation."""
