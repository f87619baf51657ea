// SPDX-License-Identifier: GPL-3.0-or-later
//
// The compiler's 128-bit integer, which ISO C++ has no name for.
#pragma once

namespace spherule {
__extension__ using Int128 = __int128;
}
