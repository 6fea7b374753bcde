"""The model: transforms, fields, volumes and their fusion."""
