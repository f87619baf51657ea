// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <filesystem>

#include "server/http/transport.h"

namespace spherule::server {

/// Connections through TLS 1.2 or later, with this certificate chain and its key (PEM). Throws invalid_argument when
/// they cannot be read or do not belong together.
MakeTransport tls_transport(const std::filesystem::path& certificate, const std::filesystem::path& key);

}  // namespace spherule::server
