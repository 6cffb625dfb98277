"""Tables of the documentation, flown anew and written into their pages."""
