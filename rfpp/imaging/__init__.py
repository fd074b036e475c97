"""Pictures: radiance encodings, tone maps, EXR files, labelled panels."""
