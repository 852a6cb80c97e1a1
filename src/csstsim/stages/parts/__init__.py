"""What the rules' files share, and the report's pictures."""
