"""The nouns: Block, Layout, Sensor, Measurement, Epoch, Problem, Track, Truth."""
