"""Where code came from: the object that a reference names, its distribution, version and hash."""
