// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

/// Put before a free function with simple loops over numbers: it is compiled for longer vectors, too, and the machine
/// that runs it picks one. Results are the same: nothing is contracted or reassociated. (Sanitizers and Clang know no
/// such functions.)
#if defined(__x86_64__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && !defined(__clang__)
#define SPHERULE_VECTORS __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SPHERULE_VECTORS
#endif
