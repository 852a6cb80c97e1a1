"""The Milky Way's dust: maps of it, and what it does to light."""
