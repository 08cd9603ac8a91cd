"""Defaults that were once chosen on test views, chosen again on validation views."""
