"""The sequential engine: blocks of rays through exact surfaces in their known order."""
