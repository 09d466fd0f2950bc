"""MJCF as MuJoCo's parser reads it."""
