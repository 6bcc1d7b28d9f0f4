"""Between a policy server and its clients: message format, checks, and the client's connection. See docs/serving.md."""
