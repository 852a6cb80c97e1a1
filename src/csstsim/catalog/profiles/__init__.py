"""Light profiles for selection, rendering and measurement."""
