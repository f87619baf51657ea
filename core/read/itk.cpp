// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/itk.h"

// Debian's ITK accepts only the family of compilers that built it; clang is near enough.
#ifdef __clang__
#pragma push_macro("__clang__")
#pragma push_macro("__GNUC__")
#undef __clang__
#undef __GNUC__
#define __GNUC__ 12
#include <itk_compiler_detection.h>
#pragma pop_macro("__GNUC__")
#pragma pop_macro("__clang__")
#endif

#include <itkMetaImageIO.h>
#include <itkNrrdImageIO.h>
#include <sys/mman.h>
#include <unistd.h>

#include <mutex>

namespace spherule {

namespace {

// A file in memory: ITK's readers take names only.
class MemoryFile {
 public:
  explicit MemoryFile(const std::string& text) : descriptor_(memfd_create("header", MFD_CLOEXEC)) {
    if (descriptor_ < 0 || write(descriptor_, text.data(), text.size()) != static_cast<ssize_t>(text.size())) {
      close(descriptor_);
      throw Error(ErrorCode::no_space, "There is no room to read the header; try again later.");
    }
  }
  ~MemoryFile() { close(descriptor_); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  std::string path() const { return "/proc/self/fd/" + std::to_string(descriptor_); }

 private:
  int descriptor_;
};

VoxelType voxel_type_of(itk::IOComponentEnum type, std::size_t bytes) {
  switch (type) {
    case itk::IOComponentEnum::FLOAT: return VoxelType::float32;
    case itk::IOComponentEnum::DOUBLE: return VoxelType::float64;
    case itk::IOComponentEnum::UCHAR: return VoxelType::uint8;
    case itk::IOComponentEnum::CHAR: return VoxelType::int8;
    case itk::IOComponentEnum::USHORT: return VoxelType::uint16;
    case itk::IOComponentEnum::SHORT: return VoxelType::int16;
    case itk::IOComponentEnum::UINT:
    case itk::IOComponentEnum::ULONG:
    case itk::IOComponentEnum::ULONGLONG: return bytes == 4 ? VoxelType::uint32 : VoxelType::uint64;
    case itk::IOComponentEnum::INT:
    case itk::IOComponentEnum::LONG:
    case itk::IOComponentEnum::LONGLONG: return bytes == 4 ? VoxelType::int32 : VoxelType::int64;
    default:
      throw Error(ErrorCode::unusable, "The header's sample type must be an 8- to 64-bit integer, float or double.");
  }
}

}  // namespace

ItkHeader parse_with_itk(ItkFormat format, const std::string& header) {
  static std::mutex mutex;
  const std::lock_guard lock(mutex);
  const MemoryFile file(header);
  try {
    itk::ImageIOBase::Pointer reader;
    if (format == ItkFormat::nrrd) {
      reader = itk::NrrdImageIO::New();
    } else {
      reader = itk::MetaImageIO::New();
    }
    reader->SetFileName(file.path());
    reader->ReadImageInformation();
    if (reader->GetPixelType() != itk::IOPixelEnum::SCALAR || reader->GetNumberOfComponents() != 1 ||
        reader->GetNumberOfDimensions() != 3) {
      throw Error(
          ErrorCode::unusable,
          "The file does not hold one scalar a voxel (colours, vectors or text); split it into one volume each.");
    }
    ItkHeader result;
    result.type = voxel_type_of(reader->GetComponentType(), reader->GetComponentSize());
    for (unsigned a = 0; a < 3; ++a) {
      result.dims[a] = static_cast<std::int64_t>(reader->GetDimensions(a));
      const std::vector<double> direction = reader->GetDirection(a);
      const int axis = static_cast<int>(a);
      for (unsigned r = 0; r < 3; ++r) result.axes.rows[r][axis] = direction[r] * reader->GetSpacing(a);
      result.origin[axis] = reader->GetOrigin(a);
    }
    return result;
  } catch (const itk::ExceptionObject&) {
    throw Error(ErrorCode::unusable,
                "The header's sample type must be an 8- to 64-bit integer, float or double, and all its fields known.");
  }
}

}  // namespace spherule
