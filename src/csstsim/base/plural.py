"""Counts in messages: 1 object, 2 objects."""


def number_of(count: int, word: str, several: str | None = None) -> str:
    """Return a count and the word, in the plural if needed. several: the plural, if it is not the word with an s."""
    return f"{count} {word if count == 1 else several or word + 's'}"
