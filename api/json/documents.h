// SPDX-License-Identifier: GPL-3.0-or-later
//
// The service's values as JSON text: what users see.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "api/service.h"
#include "core/measure/checks.h"
#include "core/measure/report.h"

namespace spherule::api {

// What users see: the bodies that openapi.yaml describes, ending in a line break. Numbers are the shortest decimals
// that read back to the same double.

std::string document_of(const Thing& thing);
/// The answer to an upload.
std::string upload_document(const UploadInfo& upload);
std::string stored_volume_document(const Stored<VolumeInfo>& stored);
std::string job_document(const JobInfo& job);
/// A page of a list; of registrations without spheres, pairs and other poses.
std::string list_document(Collection collection, const Page<Thing>& page);
std::string job_list_document(const Page<JobInfo>& page);
std::string sphere_page_document(const std::string& model, const SpherePage& page, std::uint64_t offset);
std::string value_histogram_document(const VolumeInfo& volume, std::span<const std::uint64_t> counts);
std::string radius_histogram_document(const std::string& model, const RadiusHistogram& histogram);
/// With the `listed_components` largest components at most.
std::string measures_document(const std::string& model, const ModelMeasures& measures);
inline constexpr std::size_t listed_components = 1000;
/// One slice, and the object on it, if any.
std::string slice_document(const std::string& volume, const SliceRequest& request, const Grid& slice,
                           const PlaneModel* model);
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

/// ISO 8601 UTC to the millisecond.
std::string iso_time(Time time);

}  // namespace spherule::api
