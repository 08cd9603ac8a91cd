"""A FAST-Splat scene for ROS 2: pure functions make messages, a thin node or a bag sends them."""
