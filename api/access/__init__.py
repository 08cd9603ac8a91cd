"""Access control shared by both protocols; `api.rest.access` and `api.grpc.interceptors` adapt it."""
