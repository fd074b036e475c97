"""A trained network on stored scenes: records, tables, panels, and a page that shows them."""
