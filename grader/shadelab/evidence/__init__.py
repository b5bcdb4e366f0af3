"""What student code gives: function outputs and images, as raw numbers."""
