// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registrations as JSON text: as documents.h is for everything else.
#pragma once

#include <string>
#include <string_view>

#include "api/things.h"

namespace spherule::api {

/// What users see of a finished registration; kept as it is and read back by registration_from.
std::string registration_document(const std::string& id, Time created, const std::string& algorithm_version,
                                  const RegistrationRequest& request, const Registration& found);
/// Of a document, and the record of its request (json/work.h). Throws corrupt for text that registration_document did
/// not write.
RegistrationInfo registration_from(std::string_view document, std::string_view request_record);

}  // namespace spherule::api
