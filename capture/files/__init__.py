"""Files: images, RAW, JSON documents, and results that are whole or absent."""
