// SPDX-License-Identifier: GPL-3.0-or-later
//
// The files that the command reads and writes.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/base/geometry.h"

namespace spherule::cli {

/// Throws not_found for what cannot be read as a file, such as a folder.
void check_readable(const std::vector<std::filesystem::path>& files);

/// Throws no_space where a file of this name could not be written now. Makes nothing.
void check_writable(const std::filesystem::path& file);

/// Replaces the file. Throws no_space.
void write_file(const std::filesystem::path& file, const std::string& bytes);

/// By the ending, .csv or .npy. Throws not_found and what the readers throw.
std::vector<Sphere> read_spheres(const std::filesystem::path& file);

/// A lone header with the file of samples that it names and that lies beside it (MetaImage, NRRD; .img of NIfTI and
/// Analyze); else the files as they are.
std::vector<std::filesystem::path> with_data(std::vector<std::filesystem::path> files);

}  // namespace spherule::cli
