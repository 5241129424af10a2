"""Heavy work, and libraries that read foreign bytes, kept away from the process that holds the
devices: planning and decoding, done here or in a child process that may die."""
