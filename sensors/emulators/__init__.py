"""The other end of the line: devices made of software, for tests, demos and rehearsals."""
