"""Online estimation from a stream of lines: sources, order, epochs, journal."""
