"""The language of the controllers: numbers, words and lines, without any exchange."""
