"""The robot as its topics tell of it: pose, joints, description, cameras, body."""
