"""The Survey Camera as its data files in config/instrument describe it: frozen objects, small geometry."""
