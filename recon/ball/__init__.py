"""Light read off photographs of mirror balls."""
