"""Process models, one file each."""
