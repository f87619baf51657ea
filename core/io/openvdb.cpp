// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/io/openvdb.h"

#include <openvdb/io/Compression.h>
#include <openvdb/io/io.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Dense.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <sstream>

#include "core/io/read_bytes.h"

namespace spherule {

namespace {

constexpr std::uint32_t kOldest = openvdb::OPENVDB_FILE_VERSION_NODE_MASK_COMPRESSION;
constexpr std::uint32_t kNewest = openvdb::OPENVDB_FILE_VERSION;
constexpr std::size_t kMaxEntries = 4096;  // grids in a file, metadata of a grid
constexpr std::string_view kHalfSuffix = "_HalfFloat";

[[noreturn]] void fail_damaged() {
  throw Error(ErrorCode::malformed, "The OpenVDB file is cut or damaged; send an intact file.");
}

// The file as a stream that throws at any read that comes short. OpenVDB does not look at a stream's state: it would
// go on with whatever was in its variables, for as long as a count in a damaged file says.
class Stream {
 public:
  explicit Stream(const std::filesystem::path& file) : size_(size_of_file(file)), in_(file, std::ios::binary) {
    in_.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
  }

  std::istream& in() { return in_; }

  template <typename T>
  T value() {
    T v{};
    in_.read(reinterpret_cast<char*>(&v), sizeof v);
    return v;
  }

  // Text with its length before it; lengths that the file does not have are seen before memory is taken.
  std::string text() {
    const auto length = value<std::uint32_t>();
    need(length);
    std::string s(length, '\0');
    in_.read(s.data(), length);
    return s;
  }

  /// Throws when so many bytes do not follow.
  void need(std::uint64_t bytes) {
    if (bytes > size_ - static_cast<std::uint64_t>(position())) fail_damaged();
  }

  void skip(std::uint64_t bytes) {
    need(bytes);
    in_.seekg(static_cast<std::streamoff>(bytes), std::ios::cur);
  }

  void seek(std::int64_t position) {
    if (position < 0 || static_cast<std::uint64_t>(position) > size_) fail_damaged();
    in_.seekg(position);
  }

  std::int64_t position() { return in_.tellg(); }

 private:
  std::uint64_t size_;
  std::ifstream in_;
};

// Metadata are passed over by us: OpenVDB takes their sizes on trust. Only the class of a grid matters.
openvdb::GridClass read_metadata(Stream& stream) {
  openvdb::GridClass grid_class = openvdb::GRID_UNKNOWN;
  const auto count = stream.value<std::uint32_t>();
  if (count > kMaxEntries) fail_damaged();
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::string name = stream.text();
    const std::string type = stream.text();
    if (name == openvdb::GridBase::META_GRID_CLASS && type == "string") {
      grid_class = openvdb::GridBase::stringToGridClass(stream.text());
    } else {
      stream.skip(stream.value<std::uint32_t>());
    }
  }
  return grid_class;
}

struct Descriptor {
  std::string name, type;
  bool half = false, instance = false;
  std::int64_t position = 0;
};

struct File {
  std::uint32_t version = 0;
  openvdb::VersionId library;
  std::vector<Descriptor> grids;
};

Descriptor read_descriptor(Stream& stream) {
  Descriptor d;
  d.name = stream.text();
  d.name = d.name.substr(0, d.name.find('\x1e'));  // what makes equal names unique follows a record separator
  d.type = stream.text();
  if (d.type.ends_with(kHalfSuffix)) {
    d.half = true;
    d.type.resize(d.type.size() - kHalfSuffix.size());
  }
  d.instance = !stream.text().empty();
  d.position = stream.value<std::int64_t>();
  stream.value<std::int64_t>();  // of the leaves
  const auto end = stream.value<std::int64_t>();
  if (d.position < stream.position() || end < d.position) fail_damaged();
  stream.seek(end);
  return d;
}

File read_file_header(Stream& stream) {
  File file;
  stream.value<std::int64_t>();  // the magic
  file.version = stream.value<std::uint32_t>();
  if (file.version < kOldest || file.version > kNewest) {
    throw Error(ErrorCode::unusable, "The OpenVDB file's version is " + std::to_string(file.version) +
                                         "; write it anew with version " + std::to_string(kOldest) + " to " +
                                         std::to_string(kNewest) + ".");
  }
  file.library.first = stream.value<std::uint32_t>();
  file.library.second = stream.value<std::uint32_t>();
  if (stream.value<char>() == 0) {
    throw Error(ErrorCode::unusable,
                "The OpenVDB file was written as a stream, without the places of its grids; write it as a file.");
  }
  stream.skip(36);  // the UUID
  read_metadata(stream);
  const auto count = stream.value<std::uint32_t>();
  if (count > kMaxEntries) fail_damaged();
  for (std::uint32_t i = 0; i < count; ++i) file.grids.push_back(read_descriptor(stream));
  return file;
}

template <typename GridType>
struct Of {
  using Type = GridType;
};

// Calls f(Of<GridType>) for the grid type of that name; false when it is not a scalar one.
template <typename F>
bool with_grid_type(const std::string& type, F&& f) {
  const auto is = [&]<typename G>(Of<G> tag) {
    if (type != G::gridType()) return false;
    f(tag);
    return true;
  };
  return is(Of<openvdb::FloatGrid>{}) || is(Of<openvdb::DoubleGrid>{}) || is(Of<openvdb::Int32Grid>{}) ||
         is(Of<openvdb::Int64Grid>{}) || is(Of<openvdb::BoolGrid>{});
}

bool is_scalar(const std::string& type) {
  return with_grid_type(type, [](auto) {});
}

const Descriptor& chosen_grid(const File& file, const std::string& name) {
  for (const Descriptor& d : file.grids) {
    if (name.empty() ? !is_scalar(d.type) || d.instance : d.name != name) continue;
    if (!is_scalar(d.type)) {
      throw Error(ErrorCode::unusable,
                  "The chosen OpenVDB grid is not a scalar one (bool, int32, int64, float or double); choose another.");
    }
    if (d.instance) {
      throw Error(ErrorCode::unusable,
                  "The chosen OpenVDB grid only repeats another grid elsewhere; choose the original.");
    }
    return d;
  }
  if (!name.empty()) {
    throw Error(ErrorCode::not_found, "The OpenVDB file has no grid of that name; leave out grid for the first one.");
  }
  throw Error(ErrorCode::unusable,
              "The OpenVDB file has no scalar grid (bool, int32, int64, float or double); convert points or vectors "
              "first.");
}

template <typename T>
constexpr VoxelType voxel_type_of() {
  if constexpr (std::is_same_v<T, bool>) return VoxelType::uint8;
  if constexpr (std::is_same_v<T, std::int32_t>) return VoxelType::int32;
  if constexpr (std::is_same_v<T, std::int64_t>) return VoxelType::int64;
  if constexpr (std::is_same_v<T, float>) return VoxelType::float32;
  if constexpr (std::is_same_v<T, double>) return VoxelType::float64;
}

// Index steps as columns, and the place of a voxel, in world units.
void place(Volume& volume, std::array<std::int32_t, 3> dims, const openvdb::math::Transform& transform,
           const openvdb::Coord& first) {
  const auto affine = transform.baseMap()->getAffineMap();
  const openvdb::math::Mat4d m = affine->getMat4();  // acts on row vectors
  Mat3 axes;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) axes.rows[static_cast<std::size_t>(r)][c] = m(c, r);
  }
  const openvdb::Vec3d origin = transform.indexToWorld(first);
  volume.grid = grid_from_affine(dims, axes, {origin.x(), origin.y(), origin.z()});
}

// Reads a tree, first its nodes, then the values of its leaves. OpenVDB's own functions for this lose what they have
// read, or crash, when they meet a damaged node: here every node is whole at any time and belongs to somebody. OpenVDB
// also reads as many packed values as a length in the file says, whatever the room for them: it only gets blocks that
// are as long as its nodes need, from memory.
template <typename Tree>
class TreeReader {
  using Root = typename Tree::RootNodeType;
  using Leaf = typename Tree::LeafNodeType;
  using Value = typename Tree::ValueType;
  using Stored = std::conditional_t<std::is_same_v<Value, bool>, std::uint8_t, Value>;

 public:
  /// `prepare` tells OpenVDB what it needs to know about a stream of this grid.
  template <typename Prepare>
  TreeReader(Stream& stream, const Descriptor& grid, std::uint32_t compression, const ReadLimits& limits,
             Prepare prepare)
      : stream_(stream), from_half_(grid.half), compression_(compression), max_bytes_(limits.max_bytes) {
    block_.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
    prepare(block_);
  }

  void read_topology(Root& root) {
    if (stream_.value<std::int32_t>() != 1) fail_damaged();  // buffers of a leaf
    root.setBackground(value(), /*updateChildNodes=*/false);
    background_ = root.background();
    openvdb::io::setGridBackgroundValuePtr(block_, &background_);
    const std::uint64_t tiles = stream_.value<std::uint32_t>();
    const std::uint64_t children = stream_.value<std::uint32_t>();
    for (std::uint64_t i = 0; i < tiles; ++i) {
      const openvdb::Coord origin = coord();
      const Value v = value();
      root.addTile(origin, v, stream_.value<char>() != 0);
    }
    for (std::uint64_t i = 0; i < children; ++i) root.addChild(node<typename Root::ChildNodeType>(coord()).release());
  }

  /// The leaves are in the order of the nodes.
  void read_leaves(Root& root, const Context& context) {
    for (auto child = root.beginChildOn(); child; ++child) {
      read_leaves_of(*child);
      context.throw_if_cancelled();
    }
  }

 private:
  Value value() { return static_cast<Value>(stream_.value<Stored>()); }

  openvdb::Coord coord() {
    const auto i = stream_.value<std::int32_t>(), j = stream_.value<std::int32_t>(), k = stream_.value<std::int32_t>();
    return {i, j, k};
  }

  // An internal node takes some 33 times what it needs in the file.
  void account(std::size_t bytes) {
    bytes_ += bytes;
    if (bytes_ > max_bytes_) {
      throw Error(ErrorCode::too_large, "The OpenVDB tree is larger than allowed; prune or resample the grid.");
    }
  }

  template <typename Node>
  std::unique_ptr<Node> node(const openvdb::Coord& origin) {
    account(sizeof(Node));
    if constexpr (std::is_same_v<Node, Leaf>) {
      auto leaf = std::make_unique<Leaf>(openvdb::PartialCreate(), origin, background_);
      leaf->readTopology(stream_.in(), from_half_);
      return leaf;
    } else {
      auto made = std::make_unique<Node>(origin, background_, false);
      typename Node::NodeMaskType child_mask, value_mask;
      child_mask.load(stream_.in());
      value_mask.load(stream_.in());
      if (!(child_mask & value_mask).isOff()) fail_damaged();
      {
        const auto values = std::make_unique<Value[]>(Node::NUM_VALUES);
        std::string bytes;
        take_values(bytes, value_mask);
        block_.str(std::move(bytes));
        openvdb::io::readCompressedValues(block_, values.get(), Node::NUM_VALUES, value_mask, from_half_);
        for (auto n = child_mask.beginOff(); n; ++n) made->addTile(n.pos(), values[n.pos()], value_mask.isOn(n.pos()));
      }
      for (auto n = child_mask.beginOn(); n; ++n) {
        made->addChild(node<typename Node::ChildNodeType>(made->offsetToGlobalCoord(n.pos())).release());
      }
      return made;
    }
  }

  template <typename Node>
  void read_leaves_of(Node& node) {
    if constexpr (std::is_same_v<Node, Leaf>) {
      typename Leaf::NodeMaskType mask;
      std::string bytes;
      take(bytes, mask.memUsage());
      if constexpr (std::is_same_v<Value, bool>) {
        take(bytes, 3 * sizeof(std::int32_t) + mask.memUsage());  // its origin, and a bit a voxel
      } else {
        block_.str(bytes);
        mask.load(block_);
        take_values(bytes, mask);
      }
      block_.str(std::move(bytes));
      node.readBuffers(block_, from_half_);
    } else {
      for (auto child = node.beginChildOn(); child; ++child) read_leaves_of(*child);
    }
  }

  void take(std::string& bytes, std::size_t count) {
    const std::size_t at = bytes.size();
    bytes.resize(at + count);
    stream_.in().read(bytes.data() + at, static_cast<std::streamsize>(count));
  }

  // The values of a node as they are in the file, where packed ones must be as many as the node holds.
  template <typename Mask>
  void take_values(std::string& bytes, const Mask& active) {
    using namespace openvdb::io;
    const std::size_t start = bytes.size();
    take(bytes, 1);
    const char form = bytes[start];
    const bool two = form == MASK_AND_TWO_INACTIVE_VALS;
    const bool one = form == NO_MASK_AND_ONE_INACTIVE_VAL || form == MASK_AND_ONE_INACTIVE_VAL;
    take(bytes, (two ? 2 : one ? 1 : 0) * sizeof(Value));
    if (two || form == MASK_AND_NO_INACTIVE_VALS || form == MASK_AND_ONE_INACTIVE_VAL) take(bytes, active.memUsage());

    const bool only_active = (compression_ & COMPRESS_ACTIVE_MASK) != 0 && form != NO_MASK_AND_ALL_VALS;
    const bool halved = from_half_ && std::is_floating_point_v<Value>;
    const std::size_t count = only_active ? active.countOn() : Mask::SIZE;
    const auto expected = static_cast<std::int64_t>(count * (halved ? 2 : sizeof(Value)));
    if (halved && count == 0) return;
    if ((compression_ & (COMPRESS_BLOSC | COMPRESS_ZIP)) == 0) return take(bytes, static_cast<std::size_t>(expected));
    const std::size_t at = bytes.size();
    take(bytes, sizeof(std::int64_t));
    std::int64_t length;  // negated where the values were not worth packing
    std::memcpy(&length, &bytes[at], sizeof length);
    if (length <= 0) {
      if (length != -expected) fail_damaged();
      return take(bytes, static_cast<std::size_t>(expected));
    }
    stream_.need(static_cast<std::uint64_t>(length));
    take(bytes, static_cast<std::size_t>(length));
    if (compression_ & COMPRESS_BLOSC) check_blosc(std::string_view(bytes).substr(at + sizeof length), expected);
  }

  // Blosc believes what its own header says about the sizes of the packed bytes and of what they become.
  static void check_blosc(std::string_view packed, std::int64_t expected) {
    std::array<std::uint32_t, 4> header;  // versions and flags, unpacked bytes, bytes of a part, packed bytes
    if (packed.size() < sizeof header) fail_damaged();
    std::memcpy(&header, packed.data(), sizeof header);
    if (header[1] != expected || header[3] != packed.size()) fail_damaged();
  }

  Stream& stream_;
  bool from_half_;
  std::uint32_t compression_;
  std::size_t max_bytes_, bytes_ = 0;
  Value background_{};
  std::istringstream block_;
};

template <typename GridType>
void read_grid(Volume& volume, Stream& stream, const File& file, const Descriptor& descriptor,
               const ReadOptions& options, const Context& context) {
  using Value = typename GridType::ValueType;
  using Stored = std::conditional_t<std::is_same_v<Value, bool>, std::uint8_t, Value>;
  stream.seek(descriptor.position);
  const auto compression = stream.value<std::uint32_t>();
  const openvdb::GridClass grid_class = read_metadata(stream);
  const std::int64_t transform_position = stream.position();
  const std::string map = stream.text();
  if (!openvdb::math::MapRegistry::isRegistered(map)) fail_damaged();
  if (map == openvdb::math::NonlinearFrustumMap::mapType()) {
    throw Error(ErrorCode::unusable, "The OpenVDB grid lies in a camera's frustum; resample it onto a straight grid.");
  }
  stream.seek(transform_position);

  auto metadata = std::make_shared<openvdb::io::StreamMetadata>();
  const auto prepare = [&](std::istream& of_grid) {
    openvdb::io::setStreamMetadataPtr(of_grid, metadata, /*transfer=*/false);
    openvdb::io::setVersion(of_grid, file.library, file.version);
    openvdb::io::setDataCompression(of_grid, compression);
    openvdb::io::setGridClass(of_grid, grid_class);
    openvdb::io::setHalfFloat(of_grid, descriptor.half);
    openvdb::io::setGridBackgroundValuePtr(of_grid, nullptr);
  };
  prepare(stream.in());
  // Made by the library, and all that is virtual called through the base: to compile a grid's every function here would
  // take minutes.
  const openvdb::GridBase::Ptr grid = openvdb::GridBase::createGrid(descriptor.type);
  const openvdb::TreeBase& base = grid->baseTree();
  auto& tree = openvdb::gridPtrCast<GridType>(grid)->tree();
  grid->setSaveFloatAsHalf(descriptor.half);
  grid->readTransform(stream.in());
  TreeReader<typename GridType::TreeType> reader(stream, descriptor, compression, options.limits, prepare);
  reader.read_topology(tree.root());

  openvdb::CoordBBox box;
  if (!base.evalActiveVoxelBoundingBox(box)) {
    throw Error(ErrorCode::unusable, "The OpenVDB grid has no active voxel; activate the voxels of the object.");
  }
  std::array<std::int64_t, 3> sizes{};
  for (int a = 0; a < 3; ++a) {
    sizes[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(box.max()[a]) - box.min()[a] + 3;
  }
  volume.type = voxel_type_of<Value>();
  const auto dims = checked_dims(sizes, volume.type, options.limits);
  if (box.min()[0] == INT32_MIN || box.min()[1] == INT32_MIN || box.min()[2] == INT32_MIN ||
      box.max()[0] == INT32_MAX || box.max()[1] == INT32_MAX || box.max()[2] == INT32_MAX) {
    throw Error(ErrorCode::unusable, "The OpenVDB grid reaches the end of index space; move it to the origin.");
  }
  box.expand(1);
  place(volume, dims, grid->transform(), box.min());
  // Leaves in the file need not be dense, but their buffers are: they count like samples.
  checked_dims({std::max<std::int64_t>(base.leafCount(), 1), 512, 1}, volume.type, options.limits);
  context.throw_if_cancelled();
  context.report("read", 0.2);
  reader.read_leaves(tree.root(), context);
  context.throw_if_cancelled();
  context.report("read", 0.8);

  volume.natural_side = grid_class == openvdb::GRID_LEVEL_SET ? Side::below : Side::above;
  volume.voxels.resize(volume.grid.sample_count() * sizeof(Stored));
  openvdb::tools::Dense<Stored, openvdb::tools::LayoutXYZ> dense(box, reinterpret_cast<Stored*>(volume.voxels.data()));
  openvdb::tools::copyToDense(tree, dense, /*serial=*/context.threads <= 1);
  // A damaged tile of a bool grid may be of any value.
  if constexpr (std::is_same_v<Value, bool>) {
    for (std::byte& v : volume.voxels) v = v == std::byte{0} ? v : std::byte{1};
  }
  context.report("read", 1);
}

}  // namespace

bool is_openvdb(std::string_view head) {
  return head.size() >= 12 && head.substr(0, 8) == std::string_view(" BDV\0\0\0\0", 8);
}

Volume read_openvdb(const std::filesystem::path& path, const ReadOptions& options, const Context& context) {
  openvdb::initialize();  // safe to call again and from several threads
  Volume volume;
  volume.format = "openvdb";
  chosen_frame(1, options);
  try {
    Stream stream(path);
    const File file = read_file_header(stream);
    const Descriptor& grid = chosen_grid(file, options.grid);
    with_grid_type(grid.type, [&]<typename G>(Of<G>) { read_grid<G>(volume, stream, file, grid, options, context); });
  } catch (const openvdb::ArithmeticError&) {
    throw Error(ErrorCode::unusable, "The OpenVDB grid's transform is singular; give it a scale above zero.");
  } catch (const openvdb::Exception&) {
    fail_damaged();
  } catch (const std::ios::failure&) {
    fail_damaged();
  }
  volume.warnings.push_back("OpenVDB does not name its units or the patient's axes; they were taken as mm, LPS.");
  return volume;
}

}  // namespace spherule
