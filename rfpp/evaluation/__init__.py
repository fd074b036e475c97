"""A trained network on stored scenes: records, tables, panels."""
