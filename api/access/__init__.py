"""Access control: one decision for both protocols; `api.rest.access` and `api.grpc.access` only adapt it.

policy         what each call of the contract needs
caller         who calls, known to whatever serves the call
authenticator  keys to callers
rate_limits    calls at a time and over time
gate           the three together, as a transport uses them
exposure       where the server may listen without keys
access_log     the line that every request leaves
"""
