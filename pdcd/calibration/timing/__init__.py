"""When light really comes: strips that pulse, and the times that explain them."""
