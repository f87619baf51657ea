// SPDX-License-Identifier: GPL-3.0-or-later
//
// The service's values as JSON text: what users see, what the catalogue keeps, and what ids are made of.
// The only JSON of the program is in documents.cpp, records.cpp, registration_documents.cpp, requests.cpp and
// problem.cpp.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "api/service.h"

namespace spherule::api {

// What users see: the bodies that openapi.yaml describes, ending in a line break. Numbers are the shortest decimals
// that read back to the same double.

std::string volume_document(const VolumeInfo& volume);
/// The answer to an upload.
std::string upload_document(const UploadInfo& upload);
std::string stored_volume_document(const StoredVolume& stored);
std::string model_document(const ModelInfo& model);
std::string job_document(const JobInfo& job);
/// `self` is the path that the list was asked by, for its links.
std::string volume_list_document(const Page<VolumeInfo>& page);
std::string model_list_document(const Page<ModelInfo>& page);
std::string job_list_document(const Page<JobInfo>& page);
std::string sphere_page_document(const std::string& model, const SpherePage& page, std::uint64_t offset);
std::string value_histogram_document(const VolumeInfo& volume, std::span<const std::uint64_t> counts);
std::string radius_histogram_document(const std::string& model, const RadiusHistogram& histogram);
/// With the `listed_components` largest components at most.
std::string measures_document(const std::string& model, const ModelMeasures& measures);
inline constexpr std::size_t listed_components = 1000;
/// One slice, and the object on it, if any.
std::string slice_document(const SliceRequest& request, const Grid& slice, const PlaneModel* model);
/// The same document with the `count` largest components only.
std::string with_components(std::string_view measures_document, std::size_t count);
/// Positions of parents are in the level before; `levels` are the numbers that tree_of was given.
std::string tree_document(const std::string& model, const std::string& source, std::span<const std::uint32_t> levels,
                          std::span<const TreeLevel> tree, const MemberLists& members);
std::string checks_document(const std::string& model, const ModelChecks& checks);
std::string about_document(const About& about);
std::string status_document(std::string_view status);
/// One line, without a line break: the data of a server-sent event.
std::string event_data(const JobEvent& event);

/// "queued", "running", …
std::string_view name(JobState state);
/// "csv", "npy", "ply", "vtp".
std::string_view name(SphereFormat format);
/// "index", "volume_mm3", …
std::string_view name(SphereFigure figure);
/// "spheres", "nodes", "members".
std::string_view name(SphereRows rows);
/// "index", "contribution".
std::string_view name(SphereOrder order);
/// ISO 8601 UTC to the millisecond.
std::string iso_time(Time time);
/// The path, with its query, that gives this result.
std::string path_of(const DerivedRequest& request);

// What the catalogue keeps. `x_from(record_of(x))` is x; throws corrupt for text that record_of did not write.

std::string record_of(const VolumeInfo& volume);
VolumeInfo volume_from(std::string_view record);
std::string record_of(const ModelInfo& model);
ModelInfo model_from(std::string_view record);
std::string record_of(const DerivedRequest& request);
DerivedRequest derived_from(std::string_view record);
/// Counts of a volume's values.
std::string record_of(std::span<const std::uint64_t> counts);
std::vector<std::uint64_t> counts_from(std::string_view record);
std::string record_of(const ModelRequest& request);
ModelRequest model_request_from(std::string_view record);
std::string record_of(const SimplificationRequest& request);
SimplificationRequest simplification_request_from(std::string_view record);

// What ids are made of: canonical JSON (members ascending, no spaces, defaults filled in). Equal things have equal text
// on any machine.

/// Names count only where there are several files: there a header names its data.
std::string identity_of(std::span<const StoredFile> files, const VolumeParameters& parameters);
std::string identity_of(const ModelRequest& request, const std::string& algorithm_version);
std::string identity_of(const SimplificationRequest& request, const std::string& algorithm_version);
std::string identity_of(const DerivedRequest& request, const std::string& algorithm_version);
/// Of imported spheres.
std::string identity_of(const StoredFile& file, SphereFormat format, const std::string& algorithm_version);

}  // namespace spherule::api
