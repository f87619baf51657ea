// SPDX-License-Identifier: GPL-3.0-or-later
//
// Elementary functions whose results are the same bits on every machine. Those of the C library are not: it picks its
// variant by the processor it finds, and the variants differ in last places (glibc's with and without fused
// multiplication, in the share of a sphere for one). core calls no others; what IEEE 754 defines exactly, such as
// square roots, stays with the compiler.
//
// These are SLEEF's: Shibata and Petrogalli, SLEEF: A Portable Vectorized Library of C Standard Mathematical Functions,
// IEEE Transactions on Parallel and Distributed Systems 31 (2020), in the forms that do without fused multiplication
// ("cinz"). Errors stay below 1 ulp (hypot: 0.5), special values are as in C.
#pragma once

namespace spherule::elementary {

double sin(double x);
double cos(double x);
double tan(double x);
double asin(double x);
double atan2(double y, double x);
double exp(double x);
double log(double x);
double log10(double x);
double pow(double x, double y);
double cbrt(double x);
double hypot(double x, double y);

}  // namespace spherule::elementary
