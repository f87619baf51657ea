// SPDX-License-Identifier: GPL-3.0-or-later
//
// NIfTI-1 and NIfTI-2 (https://nifti.nimh.nih.gov), single files and .hdr + .img pairs, each also gzip'ed, in either
// byte order. libnifti2 reads the header. Private to core/read; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "core/read/options.h"

namespace spherule {

/// Whether unpacked bytes start like a NIfTI header (size and magic), in either byte order. Needs 348 bytes.
bool is_nifti(std::string_view head);
/// Whether the header keeps its samples in another file.
bool is_nifti_pair(std::string_view head);
/// Whether they start like an ANALYZE 7.5 header, which NIfTI-1 grew out of: the same size without the magic.
bool is_analyze(std::string_view head);

/// `header` is one of `files`. Where it keeps its samples in another file (magic "ni1", "ni2"), that is the one of
/// `files` with the same stem and the extension .img (or .img.gz), or else the only other file.
/// Geometry: the sform where its code is above 0 and it is usable (finite, not singular, at right angles, within the
/// bounds of volume.h), else the qform where its code is above 0 (with a warning if there is an unusable sform), else
/// pixdim alone (with a warning); an sform whose steps are not as long as pixdim says is taken, with a warning. Lengths
/// by xyzt_units (unknown: mm); RAS becomes LPS. Values: scl_slope and scl_inter unless the slope is 0 or NaN.
/// Mended with a warning, as libnifti does: sizes of 0 beyond the third, a pixdim of 0 along one slice.
Volume read_nifti(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                  const ReadOptions& options, const Context& context);

}  // namespace spherule
