"""The studies: each runs one main job end to end and leaves a folder with a report."""
