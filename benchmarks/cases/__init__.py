"""One file for each group of goals; each has ``async def rows() -> list[Row]``."""
