"""The sub-commands of `localreg`, one module each, imported when they are used."""
