"""Objects rendered through a spectroscopic chip's gratings."""
