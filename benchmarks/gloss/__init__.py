"""Real gloss: photographs of glossy objects with known truth, and how near the product comes to it."""
