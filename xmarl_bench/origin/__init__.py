"""Where code came from: the object that a reference points to, its distribution, version and hash."""
