// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registrations as JSON text: as documents.h is for everything else.
#pragma once

#include <string>
#include <string_view>

#include "api/service.h"

namespace spherule::api {

/// What users see of a finished registration; kept as it is and read back by registration_from.
std::string registration_document(const std::string& id, Time created, const std::string& algorithm_version,
                                  const RegistrationRequest& request, const Registration& found);
/// Of a document. Throws corrupt for text that registration_document did not write.
RegistrationInfo registration_from(std::string_view document, std::string_view request_record);

/// Without spheres, pairs and other poses.
std::string registration_list_document(const Page<RegistrationInfo>& page);

std::string record_of(const RegistrationRequest& request);
RegistrationRequest registration_request_from(std::string_view record);
std::string record_of(const RegistrationAnswerRequest& request);
RegistrationAnswerRequest registration_answer_from(std::string_view record);
std::string identity_of(const RegistrationRequest& request, const std::string& algorithm_version);
std::string identity_of(const RegistrationAnswerRequest& request, const std::string& algorithm_version);

/// "volume", "model".
std::string_view name(Applied what);
/// The path, with its query, that gives this answer.
std::string path_of(const RegistrationAnswerRequest& request);

}  // namespace spherule::api
