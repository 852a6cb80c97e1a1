"""The report of a campaign and the figures of its bricks."""
