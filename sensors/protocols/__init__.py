"""Wire formats: bytes to records and back, without input or output."""
