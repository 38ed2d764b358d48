"""Language: what people say as vectors, and what the robot says in words. The world knows messages as integers only."""
