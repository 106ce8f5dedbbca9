"""From a TOML file to models, simulated passes and problems."""
