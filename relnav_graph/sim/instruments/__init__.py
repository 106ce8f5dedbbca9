"""What instruments read of known inputs: gyros, accelerometers."""
