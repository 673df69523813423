"""What fronts ask of an arm: motions, poses, teach mode, previews, settings, and its diagnostics."""
