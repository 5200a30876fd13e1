"""`python -m sensors`: the same commands as `localreg sensors`."""

from sensors.cli import app

if __name__ == "__main__":
    app(prog_name="sensors")
