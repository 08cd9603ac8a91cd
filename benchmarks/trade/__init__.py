"""What time, memory and bytes buy: one factor at a time around a base, and the frontier."""
