"""Controllers: commands made of estimates."""
