"""Pictures: radiance encodings, tone maps, EXR files and labeled sheets."""
