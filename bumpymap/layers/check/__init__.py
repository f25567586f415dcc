"""Write what drives over mapped ground show of a map, and read it back."""
