// SPDX-License-Identifier: GPL-3.0-or-later
//
// Bodies of requests, checked. Whatever is unknown is refused by name.
#pragma once

#include <string>
#include <string_view>

#include "api/work.h"

namespace spherule::api {

/// The body of POST /v1/models as it was sent.
struct ModelBody {
  std::string volume;
  ObjectRule rule;
  bool side_given = false;  ///< else rule.side is still to be filled in
};
/// Throws malformed for text that is not JSON, invalid_argument with a JSON pointer for every field that is unknown,
/// missing or of the wrong kind.
ModelBody model_body(std::string_view json);

/// The body of POST /v1/models/{model}/simplifications. Throws malformed and invalid_argument likewise.
SimplifyMethod simplification_body(std::string_view json);

/// The body of POST /v1/registrations. Throws like model_body, and what check_registration_options throws.
RegistrationRequest registration_body(std::string_view json);
/// `{"what": "volume" | "model"}`, or nothing: the volume.
AppliedRequest apply_body(std::string_view json);

}  // namespace spherule::api
