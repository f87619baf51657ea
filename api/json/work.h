// SPDX-License-Identifier: GPL-3.0-or-later
//
// Requests as JSON text: what the catalogue keeps of them, and what ids are made of.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "api/jobs.h"
#include "api/things.h"
#include "api/work.h"

namespace spherule::api {

/// What the catalogue keeps: canonical JSON (members ascending, no spaces, defaults filled in), the kind's edition in
/// it. Equal requests have equal text on any machine.
std::string record_of(const WorkRequest& request);
/// The request of a record; `kind` is its kind_of().name. Throws corrupt for text that record_of did not write, or of a
/// request that is not valid any more.
WorkRequest work_from(std::string_view kind, std::string_view record);

/// What the id of the result is a digest of: the record and the version of the algorithms.
std::string identity_of(const WorkRequest& request, const std::string& algorithm_version);
/// Of a volume. Names count only where there are several files: there a header names its data.
std::string identity_of(std::span<const StoredFile> files, const VolumeParameters& parameters);
/// Of imported spheres.
std::string identity_of(const StoredFile& file, SphereFormat format, const std::string& algorithm_version);

}  // namespace spherule::api
