"""Studies of many cameras: file, plan, units, table and report."""
