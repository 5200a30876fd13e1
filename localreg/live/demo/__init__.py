"""The demonstration: real walks through a real serial line, synthesized live."""
