"""Data: rendered pairs with truth, benchmark readers, annotation."""
