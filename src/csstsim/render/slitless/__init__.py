"""Objects drawn through a spectroscopic chip's gratings."""
