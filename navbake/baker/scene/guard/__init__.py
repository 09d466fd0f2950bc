"""Keeps MuJoCo's compiler from ending the process, or from working without end."""
