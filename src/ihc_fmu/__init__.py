"""The implicit homogeneous controller: offline design from (A, b, k_lin), online laws, supervisor."""
