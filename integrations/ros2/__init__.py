"""A fleet for clients of ROS 2, by Zenoh: `tutti ros2 serve`. No ROS is installed."""
