"""Studies of many cameras: a file, its plan, its units, its table and its report."""
