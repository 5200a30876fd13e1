"""What the commands of `localreg sensors` do; imported when they are called."""
