"""What strangers hand in: packed, checked without running anything, then run again where that is wanted."""
