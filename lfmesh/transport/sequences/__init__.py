"""Sequential engine: blocks of rays through exact surfaces in a known order."""
